import sys
from pathlib import Path

# The sample recordings of test/recording.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'recording'))
