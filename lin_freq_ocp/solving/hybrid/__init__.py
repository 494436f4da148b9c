"""Methods for switched dynamics of their own kind."""
