"""Defines the plan language: the text of plans with its source positions, quantities, orientations, checks, and the schedule that
is made from a plan."""
