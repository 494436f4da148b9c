"""COMPARE: what filtering a control afterwards does, beside solving with the frequency constraint."""
