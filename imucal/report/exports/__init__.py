"""The downstream files of filters and simulators; one file a format, one table of them."""
