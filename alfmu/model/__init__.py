"""Declaration of mechanisms: bodies, joints and forces; units, settings and errors.

Other rooms import `cache`, `calls`, `checks`, `content`, `doubts`, `errors`, `files`, `gallery`, `hooks`, `kept`,
`kinematics`, `making`, `mechanism`, `motion`, `parts`, `relations`, `settings`, `sources`, `spatial`, `stops`, `units`,
`words`.
"""
