"""What exists: plants, policies, their binding to a specification, and point simulation. Nothing here knows sets."""
