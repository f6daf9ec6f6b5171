"""Design: what a planned test can and cannot tell, before anything moves."""
