"""setrl: does a policy network keep a system within its specification?"""

__version__ = "0.1.0"
