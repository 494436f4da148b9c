"""From a problem to a judged outcome: which method takes which dynamics, and what is proven of its answer."""
