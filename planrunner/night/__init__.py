"""Unattended nights: suites of plans, their timetable and record; and the history of an archive of runs."""
