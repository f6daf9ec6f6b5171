"""Drivers of real tables: what every table does (`axis_table`), and one file a controller that says how it is told."""
