"""Defines the plan language: the text of plans with source positions, quantities, orientations, checks, and the schedule that
follows from a plan."""
