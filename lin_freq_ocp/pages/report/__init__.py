"""SHOW: figures, tables and one HTML page from a result or a comparison; everything is measured elsewhere."""
