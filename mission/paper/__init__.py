"""The published method: a decision once a lap, its transition, scope and optimum."""
