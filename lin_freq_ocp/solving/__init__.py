"""From a problem to a judged outcome: which method takes which dynamics, and what its answer is worth."""
