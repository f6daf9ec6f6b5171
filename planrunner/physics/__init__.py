"""Computes the physics of tests: frames, the Earth, kinematics of tables, and the stimulus of a sensor. The modules have no input
or output and no state."""
