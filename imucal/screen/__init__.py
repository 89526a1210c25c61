"""Recording -> findings: can it be trusted."""
