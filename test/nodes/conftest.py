import pytest
from support.graph import Graph


@pytest.fixture
def graph():
    graph = Graph()
    yield graph
    graph.close()
