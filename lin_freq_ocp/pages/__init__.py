"""What shows: figures, the report, the explorer."""
