"""The black box: a ring of received messages, decisions and written frames that survives SIGKILL."""
