"""Expression graphs: values, derivatives, interval enclosures and text. They know nothing of optimal control."""
