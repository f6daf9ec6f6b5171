"""Drivers of real tables: the common functions (`axis_table`), and one file per controller with its commands."""
