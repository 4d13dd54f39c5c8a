"""Tasks in processes of their own, here or on a cluster, each with limits; a lost process costs its task only."""
