"""The section POINT of a proof."""
