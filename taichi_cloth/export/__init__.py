"""The cloth as files that other programs read: one moment of it, or a whole clip."""
