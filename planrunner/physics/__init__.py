"""Physics: frames, Earth, table kinematics, stimulus and error-model terms. It has no I/O and no state."""
