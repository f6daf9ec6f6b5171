"""Contains parts that every package may use, such as findings, plug-ins, compiled kernels, locks, guarded files and folders, and
shipped files."""
