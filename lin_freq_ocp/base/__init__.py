"""What everything stands on: arrays, errors, statuses, text, polyhedra, whole files, memory, the clock."""
