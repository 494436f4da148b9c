"""Plants that are known by their frequency response."""
