"""Run folders: written whole or not at all, sealed, and read again for ever."""
