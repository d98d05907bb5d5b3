"""Contact: colliders, collision detection and response, self-collision, untangling."""
