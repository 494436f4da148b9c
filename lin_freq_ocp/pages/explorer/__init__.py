"""The live page: sliders for a problem's parameters, its answers as plain data, and the page that shows them."""
