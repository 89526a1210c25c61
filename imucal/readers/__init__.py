"""Log file -> Recording: what was recorded."""
