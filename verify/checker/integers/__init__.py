"""A second checker of the network and of what links the sets of a certificate, in integers of the standard library.

Nothing is decided here by a library of numbers: every bound is a Python integer with a scale, rounded outward by shifts
and divisions. It shares with the first checker only the readers of the files (`contract`, `network`, `layout`, `leaf`,
`certificate_file`, `cover.leaf_boxes`); their modules import python-flint, but no number of a ball comes from there.
The obligations are written again: sets are followed row by row through the network, not by composed matrices.
"""
