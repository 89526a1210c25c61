"""Consumers that are separate programs: each has a probe, run by an interpreter that can import it."""
