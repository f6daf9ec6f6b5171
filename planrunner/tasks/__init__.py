"""The work of each command as functions, for the command line and for programs: one module per verb."""
