"""The checker: an island that decides whether evidence is a proof, and shares no numerical code with what found it.

It reads the files itself (`documents`, `contract`, `network`), computes in ball arithmetic (`taylor`, `jets`), and
accepts only what comparisons of balls prove. There is no tolerance in here: where a comparison is undecided, nothing
is claimed. It imports python-flint, PyYAML's tokenizer, the ONNX message definition and the standard library, and of
setrl only the error classes.

There are two kinds of evidence. Certificates are that of VERIFIED (`certificate`): claimed sets for every cell and
period, each proved from the one before (`obligations`); docs/certificate.md states the format and every obligation.
Witnesses are that of FALSIFIED (`witness`): one trajectory that violates a requirement. `recheck` is the front door for
files, `claim` says in words what was proved.
"""
