"""One problem from many initial states, or for many references."""
