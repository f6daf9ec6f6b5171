"""Computes, before a planned test runs, what it can and cannot determine."""
