"""Handles unattended nights: suites of plans, their timetable and their record. Also handles the history of an archive of runs."""
