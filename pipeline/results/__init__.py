"""From evaluated runs to what is published: tables, curves, policies."""
