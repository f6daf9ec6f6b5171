"""Writes and reads run folders. Run folders are written atomically and sealed. All later versions of planrunner can read them."""
