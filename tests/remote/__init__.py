"""Logs behind URLs, from servers that the tests start on this machine."""
