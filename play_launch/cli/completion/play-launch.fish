# Completion of play-launch in fish.

function __play_launch_complete
    set -l words (commandline -opc)
    set -l program (string replace -r '^~' $HOME -- $words[1])
    # With the mark, the wheels of ROS leave Python alone: the answer needs no library of theirs.
    set -l answer (env _ROS_WHEELS_BOOTSTRAP_COMPLETE=1 $program completion --answer fish (commandline -cp | string collect) 2>/dev/null </dev/null)
    switch "$answer[1]"
        case files
            __fish_complete_path (commandline -ct)
        case folders
            __fish_complete_directories (commandline -ct)
        case words parts
            printf '%s\n' $answer[2..]
    end
end

complete -c play-launch -f -a '(__play_launch_complete)'
