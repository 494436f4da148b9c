"""From a problem to a judged outcome: a method for its dynamics, and the proof of the answer by the judge."""
