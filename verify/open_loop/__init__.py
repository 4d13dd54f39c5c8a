"""Open-loop queries: is there an input in a box on which a network's output is bad? No plant, no time."""
