"""Drivers of real tables: the functions that all of them share (`axis_table`), and one file per controller with its commands."""
