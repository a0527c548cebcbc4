from .markup import Node
def read(root: Node, **k): raise NotImplementedError
