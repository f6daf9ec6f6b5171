"""Analyses several recordings together: estimates the amplitudes in each recording, and attributes them to device, bench and
occasion."""
