"""Analysis of several recordings together: the amplitudes in each recording, and their attribution to device, bench and occasion."""
