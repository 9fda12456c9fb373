"""The black box: what the gateway heard, decided and wrote, in a ring that is still there after SIGKILL."""
