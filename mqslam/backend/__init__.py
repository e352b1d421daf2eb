"""The back end: it builds and optimises the pose graph, with loop closures and other sensors."""
