"""Design: what a planned test can and cannot determine, before it runs."""
