"""One file per algorithm: how it acts, and what its critic and its actor descend."""
