"""One frame in, the messages of one node out: the code that live nodes and replay share."""
