"""Reports of fleets."""
