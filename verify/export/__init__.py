"""Claims of a certificate, and the closed loop itself, as files that verifiers of networks read."""
