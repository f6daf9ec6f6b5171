"""Physics: frames, the Earth, kinematics of tables, the stimulus of a sensor, and the terms of error models. The modules have no
input or output and no state."""
