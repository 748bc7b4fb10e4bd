"""A recorded session in the formats of other tools: traces, tables, and layouts to look at it."""
