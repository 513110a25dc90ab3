def write_dataset(recordings, path):
    raise NotImplementedError
