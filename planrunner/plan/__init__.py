"""The plan language: text with source positions, quantities, orientations, checks and the schedule."""
