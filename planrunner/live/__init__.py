"""The running runs of an archive, the server of the live page, and the view on a terminal."""
