"""How a browser reaches the console: its address, TLS, HTTP, sessions, WebSockets."""
