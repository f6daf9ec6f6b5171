"""Parts that every package may use: findings, plug-ins, compiled kernels, locks, guarded files and folders, shipped files."""
