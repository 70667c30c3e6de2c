"""The node graph as data, the live launcher and the `riins` command line."""
