"""Run folders: they are written atomically, sealed, and remain readable for all later versions."""
