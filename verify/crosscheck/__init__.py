"""The same claims, decided by verifiers that others wrote: subprocesses with limits, one adapter per tool."""
