"""Words in messages: foreign text on one line, and commands with the endpoint that they need."""
