"""Consumers that are programs of their own: a probe each, run by an interpreter that has the program."""
