"""edream: a true simulator, the physics it lacks, pictures that look real, and policies trained there."""

__version__ = "0.1.0"
