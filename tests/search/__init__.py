"""The model check: every state of the supervisor that small robots reach."""
