"""Writes and reads run folders. They are written atomically and sealed, and all later versions of planrunner can read them."""
