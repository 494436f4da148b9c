"""Methods for dynamics with modes, kinks or levels: search over modes, Newton steps, interior points."""
