"""The checker: an island that decides whether evidence is a proof, and shares no numerical code with what found it.

It reads the files itself (`documents`, `contract`, `network`), computes in ball arithmetic (`taylor`, `loop`), and
accepts only what comparisons of balls prove (`witness`). There is no tolerance in here: where a comparison is
undecided, nothing is claimed. It imports python-flint, PyYAML's tokenizer, the ONNX message definition and the
standard library, and of setrl only the error classes.

What there is so far: witnesses, the evidence of FALSIFIED. Certificates, the evidence of VERIFIED, are not checked yet.
"""
