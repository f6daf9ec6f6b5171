"""Physics: frames, Earth, table kinematics, stimulus and error-model terms. No I/O and no state."""
