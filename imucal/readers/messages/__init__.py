"""Messages -> columns: a topic is a table, whose numbers are found in the bytes of its messages."""
