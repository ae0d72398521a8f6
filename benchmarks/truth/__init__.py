"""How far what is stated can be trusted, on vehicles that are not quite the model."""
