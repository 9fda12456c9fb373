"""The black box: what the gateway received, decided and wrote, in a ring that outlives SIGKILL."""
