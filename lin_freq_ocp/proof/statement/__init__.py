"""The section PROBLEM of a proof."""
