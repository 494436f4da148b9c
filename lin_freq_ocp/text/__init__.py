"""Numbers, names and tables as text and as HTML."""
