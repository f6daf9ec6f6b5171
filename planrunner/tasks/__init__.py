"""The work of each command as functions, for the command line and for programs. There is one module for each command."""
