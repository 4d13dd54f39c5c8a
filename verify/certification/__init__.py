"""Batch certification: a manifest's rows are decided, kept in a journal, judged by a gate and reported."""
