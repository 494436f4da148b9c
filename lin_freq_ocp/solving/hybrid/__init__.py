"""From a problem with modes, kinks or levels to a judged outcome."""
