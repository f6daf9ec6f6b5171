"""Runs in progress: their observation in an archive, the server of the live page, and the view on a terminal."""
