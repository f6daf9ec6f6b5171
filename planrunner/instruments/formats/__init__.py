"""Formats of recorded samples: one module per format, behind one interface (`file.py`)."""
