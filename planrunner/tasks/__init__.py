"""The work of each command as functions, for the command line and for other programs. There is one module for each command."""
