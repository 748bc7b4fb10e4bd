"""What a configuration is put together from: included files, arguments, variables, packages."""
