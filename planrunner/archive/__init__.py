"""Run folders: written atomically, sealed, and readable by all later versions."""
