"""Unattended nights: suites of plans, their timetable and record; and what happened to an archive of runs over time."""
