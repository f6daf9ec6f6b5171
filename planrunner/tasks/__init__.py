"""Contains the work of each command as functions, which the command line and other programs can call. There is one module for each
command."""
