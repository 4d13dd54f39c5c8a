"""How a provable policy is obtained. Nothing is here yet: training is the project's next stage.

Environments, losses on sets, one file per algorithm, checkpoints and evaluation through `setrl.verify` will live here.
This is the only room that imports torch (the extra ``setrl[train]``).
"""
