"""A problem solved again at every step of a control loop."""
