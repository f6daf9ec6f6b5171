"""Unattended nights: suites of plans, their timetable and their record; also the history of an archive of runs."""
