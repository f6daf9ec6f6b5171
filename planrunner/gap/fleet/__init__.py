"""Analysis of several recordings together: the amplitudes of each, and their attribution to device, bench and occasion."""
