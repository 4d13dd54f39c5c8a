"""How a provable policy is obtained: environments, losses on sets, one file per algorithm, checkpoints, evaluation.

This is the only room that imports torch (the extra ``setrl[train]``), and it is imported when it is used, never by a
user who only verifies. The sets of the trainer take their relaxations from `setrl.verify`; what a trained policy is
worth is decided by `setrl.verify`, never by the trainer.
"""
