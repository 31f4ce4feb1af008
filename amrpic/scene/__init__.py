"""The scene: the model of a run in a module per section, as TOML and from Python, with its checks and its schema."""
