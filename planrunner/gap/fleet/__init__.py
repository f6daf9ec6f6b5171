"""Analysis of several recordings together: the amplitudes of each recording, and their attribution to device, bench and occasion."""
