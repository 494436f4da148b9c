"""The section DUAL of a proof for one mode."""
