"""Running as a service of systemd: units are written, and the service manager hears how it goes."""
