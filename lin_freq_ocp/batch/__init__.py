"""Many solves: sweeps over parameters, many initial states, the shortest horizon."""
